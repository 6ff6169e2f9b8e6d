# The Uno's chip with the bench around it, in virtual time; needs libsimavr-dev. For tests only (libsimavr is GPL 3).
.PHONY: chip
chip: $(BUILD)/chip/librig_chip.so $(UNO).hex

$(BUILD)/chip/librig_chip.so: emulator/chip.c boards/host/bench.c boards/host/bench.h Makefile emulator/emulator.mk
	@mkdir -p $(BUILD)/chip
	$(CC) $(CPPFLAGS) $(CFLAGS) -Wno-pedantic -isystem /usr/include/simavr -shared -o $@ emulator/chip.c boards/host/bench.c $(LDFLAGS) -lsimavr -lm
