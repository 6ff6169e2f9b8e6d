"""Can this machine and this link hold the period: settings, measurements, and what to type to improve them."""
