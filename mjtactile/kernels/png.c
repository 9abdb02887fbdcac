/* A grey image as the data of a PNG file: rows by the filter "average", then deflate's own Huffman code of single bytes. Noise has no
   strings that come again, so none are looked for. recording/png.py; RFC 1950 and 1951, https://www.w3.org/TR/png-3/. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"

enum { END = 256, SYMBOLS = END + 1, LONGEST = 15, AVERAGE = 3, LANES = 4 };

/* -- what is packed: rows of the filter's number and its bytes --------------------------------------------------------------- */

static void filter(int64_t height, int64_t width, const uint8_t *pixels, uint8_t *rows) {
    for (int64_t y = 0; y < height; y++) {
        const uint8_t *p = pixels + y * width, *up = p - width;
        uint8_t *out = rows + y * (width + 1);
        *out++ = AVERAGE;
        if (y == 0) {
            for (int64_t x = 0; x < width; x++) out[x] = p[x] - (x ? p[x - 1] / 2 : 0);
            continue;
        }
        out[0] = p[0] - up[0] / 2;
        for (int64_t x = 1; x < width; x++) /* the mean, rounded down, without a ninth bit */
            out[x] = p[x] - ((p[x - 1] & up[x]) + ((p[x - 1] ^ up[x]) >> 1));
    }
}

static void count_bytes(int64_t n, const uint8_t *bytes, int64_t *counts) {
    int32_t each[LANES][END] = {{0}}; /* apart: the same byte twice need not wait for itself */
    for (int64_t i = 0; i < n; i++) each[i % LANES][bytes[i]]++;
    for (int s = 0; s < END; s++) counts[s] = (int64_t)each[0][s] + each[1][s] + each[2][s] + each[3][s];
}

static uint32_t adler(int64_t n, const uint8_t *bytes) {
    enum { PRIME = 65521, BLOCK = 256 };
    uint64_t one = 1, two = 0;
    for (int64_t start = 0; start < n; start += BLOCK) {
        const int size = n - start < BLOCK ? (int)(n - start) : BLOCK;
        uint32_t sum = 0, weighted = 0;
        for (int i = 0; i < size; i++) sum += bytes[start + i], weighted += (uint32_t)(size - i) * bytes[start + i];
        two = (two + size * one + weighted) % PRIME, one = (one + sum) % PRIME;
    }
    return (uint32_t)(two << 16 | one);
}

/* -- the code ----------------------------------------------------------------------------------------------------------------- */

typedef struct { int64_t count; int symbol; } Leaf;

static int by_count(const void *a, const void *b) {
    const Leaf *one = a, *other = b;
    if (one->count != other->count) return one->count < other->count ? -1 : 1;
    return one->symbol - other->symbol;
}

/* Huffman's lengths of codes by how often each symbol comes; returns the longest. */
static int code_lengths(const int64_t *counts, int *lengths) {
    Leaf leaves[SYMBOLS];
    int64_t weight[2 * SYMBOLS];
    int parent[2 * SYMBOLS], depth[2 * SYMBOLS], n = 0, longest = 0;
    memset(lengths, 0, SYMBOLS * sizeof *lengths);
    for (int s = 0; s < SYMBOLS; s++)
        if (counts[s]) leaves[n++] = (Leaf){counts[s], s};
    qsort(leaves, n, sizeof *leaves, by_count);
    for (int k = 0; k < n; k++) weight[k] = leaves[k].count;
    int leaf = 0, inner = n; /* the lightest that have no parent yet; both kinds become heavier */
    for (int k = n; k < 2 * n - 1; k++) {
        weight[k] = 0;
        for (int child = 0; child < 2; child++) {
            const int take_leaf = leaf < n && (inner == k || weight[leaf] <= weight[inner]);
            const int taken = take_leaf ? leaf++ : inner++;
            parent[taken] = k, weight[k] += weight[taken];
        }
    }
    depth[2 * n - 2] = 0;
    for (int k = 2 * n - 3; k >= 0; k--) depth[k] = depth[parent[k]] + 1;
    for (int k = 0; k < n; k++) {
        lengths[leaves[k].symbol] = depth[k];
        longest = depth[k] > longest ? depth[k] : longest;
    }
    return longest;
}

static uint32_t reversed(uint32_t code, int length) {
    uint32_t out = 0;
    for (int i = 0; i < length; i++) out |= (code >> i & 1) << (length - 1 - i);
    return out;
}

/* The codes themselves, as deflate numbers them, first bit lowest. */
static void codes_of(const int *lengths, uint32_t *codes) {
    uint32_t of_length[LONGEST + 1] = {0}, next[LONGEST + 2] = {0};
    for (int s = 0; s < SYMBOLS; s++) of_length[lengths[s]] += lengths[s] > 0;
    for (int l = 1; l <= LONGEST; l++) next[l + 1] = (next[l] + of_length[l]) << 1;
    for (int s = 0; s < SYMBOLS; s++) codes[s] = lengths[s] ? reversed(next[lengths[s]]++, lengths[s]) : 0;
}

/* -- what is written ---------------------------------------------------------------------------------------------------------- */

typedef struct { uint8_t *at; uint64_t bits; int count; } Bits; /* lowest bit first; `at` has room for eight bytes more */

static inline void put(Bits *to, uint32_t bits, int count) { to->bits |= (uint64_t)bits << to->count, to->count += count; }

static inline void flush(Bits *to) {
    for (int i = 0; i < 8; i++) to->at[i] = (uint8_t)(to->bits >> 8 * i); /* one store where bytes are in this order */
    to->at += to->count / 8, to->bits >>= to->count & ~7, to->count &= 7;
}

/* A block's head: its code as 4 bits for each length, which take a code of 4 bits each themselves. */
static void put_head(Bits *to, const int *lengths) {
    const int last = 1, dynamic = 2, distances = 1, orders = 19, none = 3; /* of the orders, which repeat lengths */
    put(to, last, 1), put(to, dynamic, 2), put(to, SYMBOLS - 257, 5), put(to, distances - 1, 5), put(to, orders - 4, 4), flush(to);
    for (int i = 0; i < orders; i++) put(to, i < none ? 0 : 4, 3), flush(to);
    for (int s = 0; s < SYMBOLS; s++) put(to, reversed((uint32_t)lengths[s], 4), 4), flush(to);
    put(to, 0, 4), flush(to); /* the one distance has no code: none is used */
}

static void put_bytes(Bits *to, int64_t n, const uint8_t *bytes, const int *lengths, const uint32_t *codes) {
    int64_t i = 0;
    for (; i + 2 < n; i += 3, flush(to)) /* 7 bits are left, and three codes have 45 at most */
        for (int k = 0; k < 3; k++) put(to, codes[bytes[i + k]], lengths[bytes[i + k]]);
    for (; i < n; i++, flush(to)) put(to, codes[bytes[i]], lengths[bytes[i]]);
    put(to, codes[END], lengths[END]), flush(to);
}

int64_t pack_png(int64_t height, int64_t width, const uint8_t *pixels, uint8_t *packed) {
    const int64_t n = height * (width + 1);
    int64_t counts[SYMBOLS];
    int lengths[SYMBOLS];
    uint32_t codes[SYMBOLS];
    if (height < 1 || width < 1) return REFUSED;
    uint8_t *rows = malloc(n);
    if (!rows) return NO_MEMORY;
    filter(height, width, pixels, rows);
    count_bytes(n, rows, counts);
    counts[END] = 1;
    while (code_lengths(counts, lengths) > LONGEST) /* rarer ones become as frequent as others */
        for (int s = 0; s < SYMBOLS; s++) counts[s] = (counts[s] + 1) / 2;
    codes_of(lengths, codes);
    Bits to = {packed, 0, 0};
    put(&to, 0x0178, 16), flush(&to); /* zlib's head */
    put_head(&to, lengths);
    put_bytes(&to, n, rows, lengths, codes);
    put(&to, 0, (8 - to.count) & 7), flush(&to);
    const uint32_t sum = adler(n, rows);
    for (int i = 3; i >= 0; i--) put(&to, sum >> 8 * i & 255, 8), flush(&to);
    free(rows);
    return to.at - packed;
}
