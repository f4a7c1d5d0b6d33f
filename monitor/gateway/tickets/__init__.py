"""Work orders: a wear alert opens one ticket in a maintenance system by REST, its end closes it, acknowledgements come back."""
