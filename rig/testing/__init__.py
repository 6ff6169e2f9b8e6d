"""What others need to test a driver or a device of theirs.

conformance   does a driver keep what every driver promises
line          the one place to put a device of a test's own
devices       emulated devices in virtual time, and what may happen to them and on their lines
"""
