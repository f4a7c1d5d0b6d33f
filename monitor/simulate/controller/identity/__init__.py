"""Who a simulated controller is: version, personality, published variables, error codes."""
