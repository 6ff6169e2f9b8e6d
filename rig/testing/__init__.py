"""What others need to test a driver of theirs."""
