"""Loops over samples that numba compiles, and keeps compiled on disk; imported where they are called, not before."""
