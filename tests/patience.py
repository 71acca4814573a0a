"""Time after which a test that waits for an event hangs."""

#: Ends what hangs [s]. A wait ends with its event, how slow the machine may be: no test measures time with it.
PATIENCE_S = 300.0
