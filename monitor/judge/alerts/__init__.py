"""What a person is told: states, alerts and their life cycle, remaining life, reasons. Pure."""
