"""States and alerts of an arm: settings, evidence, conditions, rules, life cycle, remaining life, and why a joint does not alert. Pure."""
