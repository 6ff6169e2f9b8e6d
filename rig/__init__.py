"""rig: relay-feedback identification and tracking control of a friction-impeded DC motor."""

__version__ = "0.1.0"
