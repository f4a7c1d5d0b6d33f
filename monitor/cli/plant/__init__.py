"""The commands of the plant's host: `plant …` and `gateway …`."""
