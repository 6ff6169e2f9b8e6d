"""What `rig identify` says of records of real motors."""
