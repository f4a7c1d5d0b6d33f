"""Pictures as PNG or self-contained HTML."""
