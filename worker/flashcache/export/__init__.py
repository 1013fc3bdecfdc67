"""The trained model as ONNX graphs that any runtime can evaluate, and the torch functions they must equal."""
