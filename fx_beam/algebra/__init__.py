"""Linear systems: the storage of their factors, and what factorises them."""
