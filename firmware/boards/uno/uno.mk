# The firmware of the Arduino Uno; needs gcc-avr, avr-libc and binutils-avr.
#   make uno [BRIDGE=PWM_DIR|IN1_IN2] [BAUD=115200|1000000] [TACHOMETER=1] [SUPPLY=1] [END_SWITCHES=1]
#   make size    flash, RAM and stack of it
#   make prebuilt    every variant, and the hash of each, in $(BUILD)/prebuilt: what a wheel of rig carries
# A variant is named by what differs from the default: rig_uno-in1_in2-1000000.hex. Wiring: boards/uno/wiring.h.

BRIDGE ?= PWM_DIR
BAUD ?= 115200
TACHOMETER ?= 0
SUPPLY ?= 0
END_SWITCHES ?= 0

AVR_CC := avr-gcc
UNO_SUFFIX := $(if $(filter IN1_IN2,$(BRIDGE)),-in1_in2)$(if $(filter-out 115200,$(BAUD)),-$(BAUD))$(if \
	$(filter 1,$(TACHOMETER)),-tachometer)$(if $(filter 1,$(SUPPLY)),-supply)$(if $(filter 1,$(END_SWITCHES)),-ends)
UNO := $(BUILD)/uno/rig_uno$(UNO_SUFFIX)
UNO_OBJECTS := $(UNO).o
UNO_SOURCES := $(wildcard boards/uno/*.c) $(CORE)
UNO_HEADERS := $(wildcard boards/uno/*.h core/*.h)
UNO_CPPFLAGS := -Icore -Iboards/uno -DF_CPU=16000000UL -DRIG_BUILD='"uno $(VERSION)"' -DRIG_BAUD=$(BAUD)UL \
	-DRIG_BRIDGE=BRIDGE_$(BRIDGE) -DRIG_TACHOMETER=$(TACHOMETER) -DRIG_SUPPLY=$(SUPPLY) -DRIG_END_SWITCHES=$(END_SWITCHES)
UNO_CFLAGS := -mmcu=atmega328p -std=c99 -O2 -flto -fuse-linker-plugin -fno-fat-lto-objects -ffunction-sections \
	-fdata-sections -Wl,--gc-sections $(WARNINGS)

# bridge, baud rate, tachometer, supply, end switches
VARIANTS := $(foreach b,PWM_DIR IN1_IN2,$(foreach r,115200 1000000,$(foreach t,0 1,$(foreach s,0 1,$(foreach e,0 1,$b.$r.$t.$s.$e)))))

.PHONY: uno size prebuilt $(VARIANTS)

uno: $(UNO).hex

$(UNO).elf: $(UNO_SOURCES) $(UNO_HEADERS) Makefile boards/uno/uno.mk | $(BUILD)/uno
	$(AVR_CC) $(UNO_CPPFLAGS) $(UNO_CFLAGS) -o $@ $(UNO_SOURCES)

$(UNO).hex: $(UNO).elf
	avr-objcopy -O ihex -R .eeprom $< $@

$(BUILD)/uno:
	mkdir -p $@

$(VARIANTS):
	@$(MAKE) --no-print-directory uno BRIDGE=$(word 1,$(subst ., ,$@)) BAUD=$(word 2,$(subst ., ,$@)) \
		TACHOMETER=$(word 3,$(subst ., ,$@)) SUPPLY=$(word 4,$(subst ., ,$@)) END_SWITCHES=$(word 5,$(subst ., ,$@))

prebuilt: $(VARIANTS) | $(BUILD)/prebuilt
	cp $(BUILD)/uno/*.hex $(BUILD)/prebuilt/
	cd $(BUILD)/prebuilt && sha256sum *.hex > SHA256SUMS

$(BUILD)/prebuilt:
	mkdir -p $@

size: $(UNO).elf
	@avr-size --mcu=atmega328p -C $<
