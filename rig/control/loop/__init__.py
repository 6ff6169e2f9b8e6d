"""Time: the clock on an absolute grid, the runner, and its statistics."""
