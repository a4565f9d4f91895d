"""Contact laws learned from transitions: exponentially weighted distance averages and networks."""
