"""What the tools that write pages share: one table, one way to write a page, one way to run many cases."""
