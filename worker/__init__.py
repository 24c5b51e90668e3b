"""Jobs: records, artifacts, queue, leases and the processes that run the steps of a design."""
