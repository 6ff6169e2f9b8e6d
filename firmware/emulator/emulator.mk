# The Uno's chip with the bench around it, in virtual time; needs libsimavr-dev. For tests only (libsimavr is GPL 3).
#   make chip    the shared library for the tests
#   make load    what the firmware takes of the chip: stack, interrupts; part of `make size`
CHIP := $(BUILD)/chip
CHIP_SOURCES := emulator/chip.c boards/host/bench.c
CHIP_HEADERS := emulator/chip.h boards/host/bench.h Makefile emulator/emulator.mk
CHIP_CC = $(CC) $(CPPFLAGS) $(CFLAGS) -Wno-pedantic -isystem /usr/include/simavr

.PHONY: chip load
chip: $(CHIP)/librig_chip.so $(UNO).hex

$(CHIP)/librig_chip.so: $(CHIP_SOURCES) $(CHIP_HEADERS) | $(CHIP)
	$(CHIP_CC) -shared -o $@ $(CHIP_SOURCES) $(LDFLAGS) -lsimavr -lm

$(CHIP)/report: emulator/report.c $(CHIP_SOURCES) $(CORE) $(CHIP_HEADERS) $(HEADERS) | $(CHIP)
	$(CHIP_CC) -o $@ emulator/report.c $(CHIP_SOURCES) core/frames.c $(LDFLAGS) -lsimavr -lm

$(CHIP):
	mkdir -p $@

load: $(CHIP)/report $(UNO).hex
	@$(CHIP)/report $(UNO).hex $(BAUD)

size: load
