"""Tables, connections and the statements that reach a tenant's rows."""
