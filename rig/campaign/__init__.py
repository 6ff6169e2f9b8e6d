"""Thousands of random experiments, simulated and identified: how good the estimator is, and how honest."""
