"""Webhooks: subscriptions, outbox and delivery."""
