"""`make stopping`: how soon an experiment knows its motor, and whether it is right when it stops."""
