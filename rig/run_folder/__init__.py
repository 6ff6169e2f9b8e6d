"""The run folder: written, read, listed, watched."""
