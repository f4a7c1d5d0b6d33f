"""How many contexts of an arm have a level of their own at the same time."""

SLOTS = 4  # contexts whose levels are kept at the same time
