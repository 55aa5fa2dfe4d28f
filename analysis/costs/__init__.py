"""Speed against accuracy: what fits, models and renderings cost, and how right they are."""
