"""Recordings → Identification: the parameters of an arm with their uncertainty. Pure: no I/O, no clock, no threads."""
