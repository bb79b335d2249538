"""Pure checks of a log: signals in, findings out. What they find refuses a log, or is told with its data."""
