"""Pure laws: one `step(sample) -> volts` each."""
