"""What requests and answers are made of: messages, problems, pages, conditions."""
