"""Plans for a task's episodes: to compare policies with, and to imitate."""
