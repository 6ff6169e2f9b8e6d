"""Fuzzing of what the host reads from outside: frames, replies, configs, recordings (`make fuzz`).

`targets.py` says what is fed to what and which errors are declared; `__main__.py` runs every target under atheris;
tests/fuzz runs the same targets on a bounded number of inputs.
"""
