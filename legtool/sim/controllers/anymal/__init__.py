"""The two public policies for ANYmal that QuadPiPS compares with: EM-RL and EM-DTC (section VIII-B)."""
