"""What all rooms share: samples, limits, faults, calibration, plain files, strict JSON. It imports nothing of rig."""
