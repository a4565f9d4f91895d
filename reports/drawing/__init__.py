"""What a run and a machine look like: shapes, strobes, forces, symbols and the style of every figure."""
