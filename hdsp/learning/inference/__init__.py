"""Footprint network without torch: the same costs, from the same weights, for whole maps and for patches.

- `footprint_engine`: the evaluation; `pose_table`: its constant tables of cells and weights
- `ground_kernels`, `gather_kernels`: kernels that read the ground and gather the inputs of the layers
- `footprint_layers`: the layers with their weights; `cell_layer`: convolutions at cells; `dense_layers`: products of
  matrices in ONNX Runtime
"""
