"""What is made of a history: assessments stored, recomputed, reported, exported and imported, and an arm's status. I/O."""
