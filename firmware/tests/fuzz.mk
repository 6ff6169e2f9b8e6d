# Fuzzing with libFuzzer, under the address and undefined-behaviour sanitizers; needs clang and libclang-rt-dev.
#   make fuzz [SECONDS=20] [SEED=1]    each harness for that long, from the corpus in tests/corpus; SEED=0: another each time
#   make replay                        the corpus once through each harness, with any compiler
# What is found on the way is kept in BUILD/fuzz, and a next run starts from it; so is what breaks a promise (crash-...).
FUZZ := $(BUILD)/fuzz
SECONDS ?= 20
SEED ?= 1
CLANG ?= clang
HARNESSES := frames core
FUZZ_SOURCES := tests/reference.h tests/request.h $(CORE) $(HEADERS) Makefile tests/fuzz.mk

.PHONY: fuzz replay

fuzz: $(HARNESSES:%=$(FUZZ)/fuzz_%)
	@for harness in $(HARNESSES); do \
		mkdir -p $(FUZZ)/$$harness; \
		$(FUZZ)/fuzz_$$harness -max_total_time=$(SECONDS) -seed=$(SEED) -max_len=1024 -timeout=5 -print_final_stats=1 \
			-artifact_prefix=$(FUZZ)/ $(FUZZ)/$$harness tests/corpus/$$harness >$(FUZZ)/$$harness.log 2>&1 || \
			{ cat $(FUZZ)/$$harness.log; exit 1; }; \
		awk -v name=$$harness '/ cov: / { for (i = 1; i < NF; i++) if ($$i == "cov:") edges = $$(i + 1) } \
			/^stat::number_of_executed_units/ { inputs = $$2 } \
			/^Done / { seconds = $$(NF - 1) } \
			END { printf "fuzz_%s: %d inputs in %d s, %d edges, nothing broken\n", name, inputs, seconds, edges }' \
			$(FUZZ)/$$harness.log; \
	done

replay: $(HARNESSES:%=$(FUZZ)/replay_%)
	@for harness in $(HARNESSES); do $(FUZZ)/replay_$$harness tests/corpus/$$harness/* || exit 1; done

$(FUZZ)/fuzz_%: tests/fuzz_%.c $(FUZZ_SOURCES) | $(FUZZ)
	$(CLANG) $(CPPFLAGS) -Itests $(CFLAGS) -O1 $(SANITIZE) -fsanitize=fuzzer -o $@ $< $(CORE)

$(FUZZ)/replay_%: tests/fuzz_%.c tests/replay.c $(FUZZ_SOURCES) | $(FUZZ)
	$(CC) $(CPPFLAGS) -Itests -g -O1 $(CFLAGS) -o $@ $< tests/replay.c $(CORE) $(LDFLAGS)

$(FUZZ):
	mkdir -p $@
