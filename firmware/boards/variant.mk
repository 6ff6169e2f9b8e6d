# What a firmware for a board is built with; a variant is named by what differs from the default.

BRIDGE ?= PWM_DIR
BAUD ?= 115200
TACHOMETER ?= 0
SUPPLY ?= 0
END_SWITCHES ?= 0
ENCODER ?= 0

VARIANT := $(if $(filter IN1_IN2,$(BRIDGE)),-in1_in2)$(if $(filter-out 115200,$(BAUD)),-$(BAUD))$(if \
	$(filter 1,$(TACHOMETER)),-tachometer)$(if $(filter 1,$(SUPPLY)),-supply)$(if $(filter 1,$(END_SWITCHES)),-ends)$(if \
	$(filter 1,$(ENCODER)),-encoder)

# make prebuilt    every variant for both boards, and the hash of each, in $(BUILD)/prebuilt: what a wheel of rig carries
# bridge, baud rate, tachometer, supply, end switches, encoder
EVERY_VARIANT := $(foreach b,PWM_DIR IN1_IN2,$(foreach r,115200 1000000,$(foreach t,0 1,$(foreach s,0 1,$(foreach e,0 1,$(foreach \
	c,0 1,$b.$r.$t.$s.$e.$c))))))
# a test's wheel has only some of them
VARIANTS := $(or $(RIG_VARIANTS),$(EVERY_VARIANT))

.PHONY: prebuilt every-variant $(VARIANTS)

every-variant:
	@echo $(EVERY_VARIANT)

$(VARIANTS): | $(BUILD)/pico/uf2
	@$(MAKE) --no-print-directory uno pico BRIDGE=$(word 1,$(subst ., ,$@)) BAUD=$(word 2,$(subst ., ,$@)) \
		TACHOMETER=$(word 3,$(subst ., ,$@)) SUPPLY=$(word 4,$(subst ., ,$@)) END_SWITCHES=$(word 5,$(subst ., ,$@)) \
		ENCODER=$(word 6,$(subst ., ,$@))

prebuilt: $(VARIANTS) | $(BUILD)/prebuilt
	cp $(BUILD)/uno/*.hex $(BUILD)/pico/*.uf2 $(BUILD)/prebuilt/
	cd $(BUILD)/prebuilt && sha256sum *.hex *.uf2 > SHA256SUMS

$(BUILD)/prebuilt:
	mkdir -p $@
