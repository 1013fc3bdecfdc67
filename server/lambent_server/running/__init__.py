"""From a queued job to a process: the queue, the controller, the reconciler."""
