"""The plant: the histories of many arms copied into one database, and how each arm is now. Each arm's own history stays the truth."""
