"""Command line: one verb for each thing that a user does, each in a module that is imported when it is called."""
