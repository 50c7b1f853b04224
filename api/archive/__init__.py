"""Many recordings at once: on several processes or a cluster, resumable, with the results kept in one table."""
