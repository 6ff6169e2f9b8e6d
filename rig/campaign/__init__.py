"""Thousands of random experiments, simulated and identified, to measure the estimator and to test its intervals."""
