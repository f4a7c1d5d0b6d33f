"""Computations in processes of their own, which end with what they loaded."""
