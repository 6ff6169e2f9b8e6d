"""`rig calibrate`: what a bench's config must say of sensor, travel and drive, measured in a dialogue.

steps      what each step asks, measures and puts into the config
sums       what comes of the measurements, and what is refused
dialogue   questions, readings and strokes, as data; a step asks for them, and knows no terminal and no device
draft      the config with what has been found so far
wiring     drawings: which wires to check, and which two to swap
bench      does readings and strokes, on a real or an emulated bench
save       puts the result into the config file
session    from the config to the changed config, for a terminal and for a page
"""
