"""What the tools share: one table, one way to make a page, to read a data file, and to run many cases."""
