"""Loops over samples, in C (firmware/motor): arrays in, arrays out. What goes in may be of any order in memory."""
