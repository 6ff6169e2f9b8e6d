# The Pico's emulated chip: the bench for node (bench_for_node.c). The rest is emulator/pico/*.js on rp2040js, which tools/setup.sh fetches.
#   make pico-chip
PICO_CHIP := emulator/pico
NODE_API := $(PICO_CHIP)/node_modules/node-api-headers/include

.PHONY: pico-chip
pico-chip: $(BUILD)/pico/bench.node $(PICO).uf2

$(BUILD)/pico/bench.node: $(PICO_CHIP)/bench_for_node.c boards/host/bench.c $(MOTOR) $(HEADERS) Makefile | $(BUILD)/pico
	$(CC) $(CPPFLAGS) $(CFLAGS) -isystem $(NODE_API) -shared -o $@ $(filter %.c,$^) $(LDFLAGS) -lm
