"""One module a step; a published step stays as it is."""
