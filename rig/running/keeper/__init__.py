"""The process that stops the device where a law of a user's own never returns, and what it agrees on with the loop."""
