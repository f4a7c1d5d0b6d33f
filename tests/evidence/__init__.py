"""Evidence: what the figures of the documentation are made of. Each module is a command; none is in the wheel."""

import argparse


def at_least_one(text: str) -> int:
    """The number of arms that an argument asks for. Raises argparse.ArgumentTypeError, whose text argparse shows."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number from 1 on")
    return int(text)
