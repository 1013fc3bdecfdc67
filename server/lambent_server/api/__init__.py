"""The parts of requests and answers: messages, problems, pages, conditions."""
