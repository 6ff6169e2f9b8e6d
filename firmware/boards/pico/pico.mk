# The firmware of the Raspberry Pi Pico; needs gcc-arm-none-eabi and binutils-arm-none-eabi, no C library and no SDK.
#   make pico [BRIDGE=PWM_DIR|IN1_IN2] [BAUD=115200|1000000] [TACHOMETER=1] [SUPPLY=1] [END_SWITCHES=1] [ENCODER=1]
#   make pico-size    flash and RAM of it
# A variant is named as the Uno's: rig_pico-in1_in2-1000000.uf2. Wiring: boards/pico/wiring.h.

ARM := arm-none-eabi-
PICO := $(BUILD)/pico/rig_pico$(VARIANT)
PICO_SOURCES := boards/pico/boot2.S $(wildcard boards/pico/*.c boards/chip/*.c) $(CORE)
PICO_HEADERS := $(wildcard boards/pico/*.h boards/chip/*.h core/*.h)
PICO_CPPFLAGS := -Icore -Iboards/pico -Iboards/chip -DRIG_BUILD='"pico $(VERSION)"' -DRIG_BAUD=$(BAUD)u -DRIG_BRIDGE=BRIDGE_$(BRIDGE) \
	-DRIG_TACHOMETER=$(TACHOMETER) -DRIG_SUPPLY=$(SUPPLY) -DRIG_END_SWITCHES=$(END_SWITCHES) \
	-DRIG_ENCODER=$(ENCODER)
# no idioms: the loops of memcpy and memset must not become calls of themselves
PICO_CFLAGS := -mcpu=cortex-m0plus -mthumb -std=c99 -O2 -ffreestanding -fno-tree-loop-distribute-patterns \
	-ffunction-sections -fdata-sections $(filter-out -pedantic,$(WARNINGS))

.PHONY: pico pico-size

pico: $(PICO).uf2

$(PICO).elf: $(PICO_SOURCES) $(PICO_HEADERS) boards/pico/pico.ld Makefile boards/pico/pico.mk | $(BUILD)/pico
	$(ARM)gcc $(PICO_CPPFLAGS) $(PICO_CFLAGS) -nostdlib -T boards/pico/pico.ld -Wl,--gc-sections -o $@ $(PICO_SOURCES) -lgcc

$(PICO).uf2: $(PICO).elf $(BUILD)/pico/uf2
	$(ARM)objcopy -O binary $< $(PICO).bin
	$(BUILD)/pico/uf2 $(PICO).bin $@

$(BUILD)/pico/uf2: tools/uf2.c | $(BUILD)/pico
	$(CC) $(CFLAGS) -D_XOPEN_SOURCE=700 -o $@ $<

$(BUILD)/pico:
	mkdir -p $@

pico-size: $(PICO).elf
	@$(ARM)size $<
