// Real spherical harmonics up to degree 3 in the order and with the signs of 3DGS (Condon-Shortley phase kept);
// coefficient k of band l is number k - l^2 of the band. Rust twin: `sh_basis` in engine/src/render/deform_project.rs.
#ifndef SPGS_SH
#define SPGS_SH

const float SH_0 = 0.28209479177387814;  // sqrt(1 / 4 pi)
const float SH_1 = 0.4886025119029199;   // sqrt(3 / 4 pi)
const float SH_2A = 1.0925484305920792;  // sqrt(15 / 4 pi)
const float SH_2B = 0.31539156525252005; // sqrt(5 / 16 pi)
const float SH_2C = 0.5462742152960396;  // sqrt(15 / 16 pi)
const float SH_3A = 0.5900435899266435;  // sqrt(35 / 32 pi)
const float SH_3B = 2.890611442640554;   // sqrt(105 / 4 pi)
const float SH_3C = 0.4570457994644658;  // sqrt(21 / 32 pi)
const float SH_3D = 0.3731763325901154;  // sqrt(7 / 16 pi)
const float SH_3E = 1.445305721320277;   // sqrt(105 / 16 pi)

void sh_band_1(vec3 d, out float b[3]) {
    b[0] = -SH_1 * d.y;
    b[1] = SH_1 * d.z;
    b[2] = -SH_1 * d.x;
}

void sh_band_2(vec3 d, out float b[5]) {
    b[0] = SH_2A * d.x * d.y;
    b[1] = -SH_2A * d.y * d.z;
    b[2] = SH_2B * (2.0 * d.z * d.z - d.x * d.x - d.y * d.y);
    b[3] = -SH_2A * d.x * d.z;
    b[4] = SH_2C * (d.x * d.x - d.y * d.y);
}

void sh_band_3(vec3 d, out float b[7]) {
    float xx = d.x * d.x;
    float yy = d.y * d.y;
    float zz = d.z * d.z;
    b[0] = -SH_3A * d.y * (3.0 * xx - yy);
    b[1] = SH_3B * d.x * d.y * d.z;
    b[2] = -SH_3C * d.y * (4.0 * zz - xx - yy);
    b[3] = SH_3D * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    b[4] = -SH_3C * d.x * (4.0 * zz - xx - yy);
    b[5] = SH_3E * d.z * (xx - yy);
    b[6] = -SH_3A * d.x * (xx - 3.0 * yy);
}

#endif
