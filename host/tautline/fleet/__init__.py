"""Many robots: every session calibrated, what they say of each other, and of the next one."""
