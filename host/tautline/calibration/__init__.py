"""From a recording to B(q), f_remain and the delay."""
