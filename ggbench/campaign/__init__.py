"""Which runs there are, and running them: here, in processes, on a cluster."""
