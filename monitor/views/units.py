"""Factors between the units of documents and those that a person reads."""

PERCENT_PER_MONTH = 100 * 30  # times a fraction a day gives per cent a month of 30 days
