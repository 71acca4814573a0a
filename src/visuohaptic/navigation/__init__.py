"""Maps to graphs, tags to plans: where a robot drives and what it pushes aside (Alt 2016, Ch. 4)."""
