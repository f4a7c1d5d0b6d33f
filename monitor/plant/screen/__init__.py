"""The plant's screen: every arm in one list, the worst first; the alerts of all; each arm's page; who may do what, and who did it."""
