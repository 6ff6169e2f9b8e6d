"""Which test to drive next: the one that should tell enough about the motor soonest (docs/design.md).

best_test       what to drive, ``Design``, for a ``Task``
stroke_search, relay_search   how the two kinds are found
outlook         what a test is expected to do, by exact simulation
belief          the motor as far as it is known
room            what a test may use of the bench
"""
