"""Speed against accuracy: what scans and simulations cost, and how right they are."""
