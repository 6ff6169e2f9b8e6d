"""The schema of an experiment, and loading it with errors that name file, line and key."""
