"""All that drives: a config is checked, the bench calibrated, the script run, recorded, replayed."""
