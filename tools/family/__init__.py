"""The sealed family: mechanisms and causes that share no code with the package, and a score."""
