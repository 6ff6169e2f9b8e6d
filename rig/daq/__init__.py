"""The old names of what a driver of another package is written with; they stay."""
