"""Results as pages and pictures, and what they are drawn from."""
