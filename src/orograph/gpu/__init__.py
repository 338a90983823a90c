"""The GPU itself: adapters and devices, bind groups, recorded passes, its clock, and all shaders (``shaders/*.wgsl``).

Needs the extra ``gpu`` (wgpu) and a driver for Vulkan, Metal or Direct3D 12; Mesa's lavapipe is a Vulkan driver without
any hardware. Import ``orograph.gpu.device`` to ask for a device. What is computed with it: ``lighting.gpu``; what is
drawn with it: ``rendering.gpu``.
"""
