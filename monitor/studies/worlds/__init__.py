"""Worlds that nobody assumed: laws of noise, heat and wear that are not the judge's, and fleets that live in them."""
