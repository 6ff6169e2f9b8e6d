"""Which test to drive next: the one that should tell enough about the motor soonest (docs/design.md).

best_test     what to drive, ``Design``, for a ``Task``; how the two kinds are found
outlook       what a test is expected to do, by exact simulation
belief        the motor as far as it is known
planned_test  the tests, and what one may use of the bench
stop_rule     when it is enough, and the noise that this is judged by
"""
