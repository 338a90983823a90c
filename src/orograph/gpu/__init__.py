"""The GPU itself: adapters and devices, bind groups, recorded passes, its clock, and all shaders (``shaders/*.wgsl``).

Needs the extra ``gpu`` (wgpu) and a driver for Vulkan, Metal or Direct3D 12; Mesa's lavapipe is a Vulkan driver without
hardware. Import ``orograph.gpu.device`` to open a device. Computations that use it: ``lighting.gpu``; renderers:
``rendering.gpu``.
"""
