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
