"""What a machine is asked to do: kernels compiled by numba, the LLVM of Dr.Jit, workers on other machines."""
