"""The gateway: what the plant knows, told to people and to a plant's other systems. A process of its own, beside the plant."""
