"""`rig calibrate`: what a bench's config must say of sensor, travel and drive, measured in a dialogue.

steps      what each step asks, measures, computes and puts into the config, and what it refuses
dialogue   questions, readings and strokes, as data; a step asks for them, and knows no terminal and no device
draft      the config with what has been found so far, and how that gets into the file
wiring     drawings: which wires to check, and which two to swap
bench      does readings and strokes, on a real or an emulated bench
session    from the config to the changed config, for a terminal and for a page
"""
