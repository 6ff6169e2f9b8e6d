"""`make stalls`: a host that stands still at random, against random motors, in virtual time."""
