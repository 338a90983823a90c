"""The GPU: adapters and devices (``device``), shaders (``shaders/*.wgsl``), what is computed and drawn with them.

Needs the extra ``gpu`` (wgpu) and a driver for Vulkan, Metal or Direct3D 12; Mesa's lavapipe is a Vulkan driver without
any hardware. Import ``orograph.gpu.device`` to ask for a device; nothing here is imported by the rest of the package.
"""
