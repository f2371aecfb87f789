"""Where a model and the instrument part, which effect is the cause, and how far adding it shrinks the gap."""
