"""Production cells: programs, parts and people around a simulated arm."""
