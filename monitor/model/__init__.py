"""The arm as mathematics: what design, identify and judge share. Pure."""
