"""From an identified motor to a tuned loop: gains, margins of the worst motor of its intervals, and a prediction."""
