"""The bundle's networks as compiled functions, without onnxruntime."""
