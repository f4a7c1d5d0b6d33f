"""A plant of simulated arms on a real bus: the rehearsal fleet's lives, published and answered as monitors do, for trying the plant."""
