"""Can this machine and this link hold the period: what is set how, what was measured, and what to type to mend it."""
