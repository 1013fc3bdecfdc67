"""Tables, connections and the one way to reach a tenant's rows."""
