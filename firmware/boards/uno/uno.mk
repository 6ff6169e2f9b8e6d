# The firmware of the Arduino Uno; needs gcc-avr, avr-libc and binutils-avr.
#   make uno [BRIDGE=PWM_DIR|IN1_IN2] [BAUD=115200|1000000] [TACHOMETER=1] [SUPPLY=1] [END_SWITCHES=1] [ENCODER=1]
#   make size    flash, RAM and stack of it
# A variant is named by what differs from the default: rig_uno-in1_in2-1000000.hex. Wiring: boards/uno/wiring.h.

AVR_CC := avr-gcc
UNO := $(BUILD)/uno/rig_uno$(VARIANT)
UNO_OBJECTS := $(UNO).o
UNO_SOURCES := $(wildcard boards/uno/*.c boards/chip/*.c) $(CORE)
UNO_HEADERS := $(wildcard boards/uno/*.h boards/chip/*.h core/*.h)
UNO_CPPFLAGS := -Icore -Iboards/uno -Iboards/chip -DF_CPU=16000000UL -DRIG_BUILD='"uno $(VERSION)"' -DRIG_BAUD=$(BAUD)UL \
	-DRIG_BRIDGE=BRIDGE_$(BRIDGE) -DRIG_TACHOMETER=$(TACHOMETER) -DRIG_SUPPLY=$(SUPPLY) -DRIG_END_SWITCHES=$(END_SWITCHES) \
	-DRIG_ENCODER=$(ENCODER)
UNO_CFLAGS := -mmcu=atmega328p -std=c99 -O2 -flto -fuse-linker-plugin -fno-fat-lto-objects -ffunction-sections \
	-fdata-sections -Wl,--gc-sections $(WARNINGS)

.PHONY: uno size

uno: $(UNO).hex

$(UNO).elf: $(UNO_SOURCES) $(UNO_HEADERS) Makefile boards/uno/uno.mk | $(BUILD)/uno
	$(AVR_CC) $(UNO_CPPFLAGS) $(UNO_CFLAGS) -o $@ $(UNO_SOURCES)

$(UNO).hex: $(UNO).elf
	avr-objcopy -O ihex -R .eeprom $< $@

$(BUILD)/uno:
	mkdir -p $@

size: $(UNO).elf
	@avr-size --mcu=atmega328p -C $<
