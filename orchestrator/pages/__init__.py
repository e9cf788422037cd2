"""What the user looks at: figures, and HTML pages with them."""
