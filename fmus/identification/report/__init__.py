"""What was found, as a page with figures."""
