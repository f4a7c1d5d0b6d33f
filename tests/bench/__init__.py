"""How fast, side by side in one run: `python -m tests.bench [--save FILE] [--compare A B]`."""
