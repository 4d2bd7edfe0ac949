//! Files of PyTorch, which are recognised so that an error can say how to export them.

/// The advice for a file of PyTorch that is given as a policy.
pub const ADVICE: &str = "it is a zip archive or a pickle, as PyTorch (.pt, .pth) and Stable-Baselines3 (.zip) save networks, \
                          expected a network that runs without Python: export it to ONNX, in PyTorch with \
                          torch.onnx.export(network, observation, \"policy.onnx\"), and describe it in a YAML file as \
                          examples/policies/rsl_rl.yaml does";

/// Returns true if bytes begin as files of PyTorch do: a zip archive, or a pickle of protocol 2 to 5.
pub fn is_pytorch(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04") || matches!(bytes, [0x80, 2..=5, ..])
}
