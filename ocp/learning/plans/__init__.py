"""Plans of the optimal control problem that a task's episode is: to compare with, and to imitate."""
