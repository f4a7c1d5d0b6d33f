"""The arm as mathematics, which design, identification and judging share. Pure: no clock, no threads, no I/O but the shipped files."""
