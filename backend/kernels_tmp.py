from typing import Literal

import torch
import torch.nn.functional as F

Activation = Literal["relu", "softplus"]
_act = {"relu": torch.relu, "softplus": F.softplus}
def curve_mlp(x, w1, b1, w2, b2, activation):
    h = _act[activation](w1[:, :, None] * x[:, None, :] + b1[:, :, None])
    return (w2[:, :, None] * h).sum(1) + b2[:, None]
def small_mlp(x, W1, b1, W2, b2, activation):
    return W2 @ _act[activation](W1 @ x + b1[:, None]) + b2[:, None]
def evaluate_sh(dc, rest, means, viewpoint, degree):
    out = 0.28209479177387814 * dc[:, 0]
    if degree == 0: return out
    d = F.normalize(means.detach() - viewpoint, dim=1)
    x, y, z = d.unbind(1)
    b = [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 1:
        b += [1.0925484305920792*x*y, -1.0925484305920792*y*z, 0.31539156525252005*(2*z*z-x*x-y*y), -1.0925484305920792*x*z, 0.5462742152960396*(x*x-y*y)]
    if degree > 2:
        b += [-0.5900435899266435*y*(3*x*x-y*y), 2.890611442640554*x*y*z, -0.4570457994644658*y*(4*z*z-x*x-y*y), 0.3731763325901154*z*(2*z*z-3*x*x-3*y*y), -0.4570457994644658*x*(4*z*z-x*x-y*y), 1.445305721320277*z*(x*x-y*y), -0.5900435899266435*x*(x*x-3*y*y)]
    B = torch.stack(b, 1)
    return out + torch.einsum("nk,nkc->nc", B, rest[:, :B.shape[1]])
def _win(dtype):
    x = torch.arange(11, dtype=dtype) - 5
    g = torch.exp(-x*x/(2*1.5**2)); return g/g.sum()
def _blur(x):
    g = _win(x.dtype); c = x.shape[0]
    x = F.conv2d(x[:, None], g.view(1,1,1,11), padding=(0,5)); return F.conv2d(x, g.view(1,1,11,1), padding=(5,0))[:,0]
def ssim(a, b):
    n = a.shape[0]
    m = _blur(torch.cat([a, b, a*a, b*b, a*b])); ma, mb, aa, bb, ab = m.split(n)
    C1, C2 = 0.01**2, 0.03**2
    return (((2*ma*mb+C1)*(2*(ab-ma*mb)+C2))/((ma*ma+mb*mb+C1)*(aa-ma*ma+bb-mb*mb+C2))).mean()
def gaussian_blur(x, size, sigma):
    r = size//2; t = torch.arange(size, dtype=x.dtype)-r
    g = torch.exp(-t*t/(2*sigma**2)); g = g/g.sum()
    x = F.pad(x[None], (r,r,r,r), mode="reflect")[0]
    x = F.conv2d(x[:, None], g.view(1,1,1,size)); return F.conv2d(x, g.view(1,1,size,1))[:,0]
