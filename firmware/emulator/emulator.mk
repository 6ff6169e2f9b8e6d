# The Uno's chip with the bench around it; needs libsimavr-dev. For tests only (libsimavr is GPL 3).
#   make chip    a shared library
#   make load    what the firmware takes of the chip: stack, interrupts; part of `make size`. With ENCODER=1 the encoder
#                turns with EDGES edges a second
EDGES ?= 12500
CHIP_OUT := $(BUILD)/chip
CHIP_SOURCES := emulator/chip.c emulator/timer1.c boards/host/bench.c $(MOTOR) boards/host/wire.c
CHIP_HEADERS := emulator/chip.h emulator/timer1.h boards/host/bench.h motor/plain_motor.h motor/real_motor.h boards/host/wire.h Makefile emulator/emulator.mk
CHIP_CC = $(CC) $(CPPFLAGS) $(CFLAGS) -Wno-pedantic -isystem /usr/include/simavr

.PHONY: chip load
chip: $(CHIP_OUT)/librig_chip.so $(UNO).hex

$(CHIP_OUT)/librig_chip.so: $(CHIP_SOURCES) $(CHIP_HEADERS) | $(CHIP_OUT)
	$(CHIP_CC) -shared -o $@ $(CHIP_SOURCES) $(LDFLAGS) -lsimavr -lm

$(CHIP_OUT)/report: emulator/report.c $(CHIP_SOURCES) $(CORE) $(CHIP_HEADERS) $(HEADERS) | $(CHIP_OUT)
	$(CHIP_CC) -o $@ emulator/report.c $(CHIP_SOURCES) core/frames.c $(LDFLAGS) -lsimavr -lm

$(CHIP_OUT):
	mkdir -p $@

load: $(CHIP_OUT)/report $(UNO).hex
	@$(CHIP_OUT)/report $(UNO).hex $(BAUD) $(if $(filter 1,$(ENCODER)),$(EDGES))

size: load
