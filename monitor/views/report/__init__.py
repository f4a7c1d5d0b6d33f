"""The printed report: one self-contained HTML page."""
