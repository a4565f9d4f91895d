"""Laws from data: transitions, the exponentially weighted average of them, and networks."""
