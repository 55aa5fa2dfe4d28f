"""The white reference and the certificates of its panels."""
